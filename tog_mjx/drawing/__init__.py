"""What is seen: figures, pages, viewers."""
