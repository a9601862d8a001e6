"""The version of the distribution, which the package's metadata says."""

from recon.base.package import version

__version__ = version()
