"""Descents, and the methods to take."""
