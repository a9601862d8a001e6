"""Functions for Python users and for the commands; none of them prints."""
