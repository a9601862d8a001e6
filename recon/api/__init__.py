"""Provide functions for Python users and for the commands; none of them prints."""
