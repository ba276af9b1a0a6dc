"""What the file says: read from the model alone, before anything moves."""
