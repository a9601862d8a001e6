"""Every diagnosis of an input or of a fit.

A `Finding` has a code and numbers; `CODES` has its severity and its words. `add_verdict` gives a motion its findings
and the verdict that follows from them. Findings that fit a clip again are `input_findings`; those that compare its
cameras are `agreement_findings`.
"""
