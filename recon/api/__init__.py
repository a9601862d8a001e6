"""Functions for Python users and for the commands, none of which prints."""
