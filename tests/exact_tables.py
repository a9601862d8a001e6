"""Read CSV files to the last digit, which is pandas' default only from version 3 on."""

from __future__ import annotations

from functools import partial

import pandas as pd

_IS_OLD = int(pd.__version__.split(".")[0]) < 3
read_csv = partial(pd.read_csv, **({"float_precision": "round_trip"} if _IS_OLD else {}))
