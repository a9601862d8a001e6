"""Command line of the wing: `recon ik`, `retarget`, `robot` and `climb`. One module for each command."""

import recon.workflows.cli  # noqa: F401  # the table that names these modules comes first, whoever imports one of them
