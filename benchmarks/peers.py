"""Compare recon with other programs for several cameras, on the same files.

    python benchmarks/peers.py [--only NAME ...] [--quick]

Results are kept in benchmarks/results/peers.json. `python benchmarks/tables.py` writes the tables of the docs.
"""

from __future__ import annotations

from question import Part, main

PARTS = {
    "runs": Part("peers.py", quick=["--quick", "--cases", "clean"], data="cheetah-runs"),
}


if __name__ == "__main__":
    main(__doc__ or "", "peers", PARTS)
