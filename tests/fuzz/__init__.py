"""Every reader and settings file against files that are spoilt in many ways. See `tests/fuzz/__main__.py`."""
