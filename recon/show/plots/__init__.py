"""Figures of a result, for print: one function for each, which returns matplotlib's Figure. `save` writes it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
