"""Detect faults in the inputs and the result of a fit, and give the verdict on a clip.

A `Finding` has a code and numbers, and `CODES` has the severity and the message for each code. `input_findings` fits
parts of the clip again to detect wrong inputs, and `agreement_findings` compares the cameras. `add_verdict` adds all
other findings to a motion, and the verdict that follows from them.
"""
