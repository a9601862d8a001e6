"""The commands of the frame method and of the solver's inspection, one module each."""

import recon.workflows.cli  # the table that names these modules comes first, whoever imports one of them
