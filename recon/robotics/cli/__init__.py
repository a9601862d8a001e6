"""Command line of the wing: `recon ik`, `retarget`, `robot` and `climb`. One module for each command."""
