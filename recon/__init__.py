from importlib import metadata

__version__ = "0.1.0"
