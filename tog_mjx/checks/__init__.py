"""Whether a gradient can be trusted: a preflight of the scene, then one check a file, and a verdict."""
