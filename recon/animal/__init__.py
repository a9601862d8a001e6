"""The animal: its body, skeleton and subject files, detectors, names, and what its motions look like."""
