"""Version of the distribution, from the package's metadata."""

from recon.base.package import version

__version__ = version()
