"""Diagnose faults of an input or of a fit.

A `Finding` has a code and numbers; `CODES` gives the severity and text of each code. `add_verdict` adds the findings of
a motion and the verdict that follows from them. `input_findings` fits parts of the clip again to detect wrong inputs;
`agreement_findings` compares the cameras.
"""
