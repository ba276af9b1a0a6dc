"""What is measured: one check a file."""
