"""C MuJoCo as an engine: motions forward, every step linearised, and one sweep over the linear steps."""
