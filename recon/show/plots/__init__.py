"""Draw figures of a result for print.

Each function returns a matplotlib Figure, which `save` writes.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
