"""The commands of the keypoint network, one module each."""

import recon.workflows.cli  # noqa: F401  # the table that names these modules comes first, whoever imports one of them
