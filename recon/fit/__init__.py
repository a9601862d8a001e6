"""Fit an animal's motion over a whole clip to the views of its cameras.

All solving for an animal's motion happens in this package, except the frame method in `recon.thesis`.
`recon.fit.constants` holds the numbers that no user sets.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
