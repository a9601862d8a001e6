"""Damage files in many ways, and read them by every reader and settings file. See `tests/fuzz/__main__.py`."""
