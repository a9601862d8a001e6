"""Damage files in many ways, and read them by every reader of the package (see `tests/fuzz/__main__.py`)."""
