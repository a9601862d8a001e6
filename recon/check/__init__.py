"""Every diagnosis of an input or of a fit: a `Finding` has a code and numbers, `CODES` its severity and its words.

`judged` gives a motion its findings and the verdict that follows from them. Findings that fit a clip again are
`input_findings`, those that compare its cameras `agreement_findings`.
"""

from recon.check.agreement import agreement_findings
from recon.check.codes import CODES, FLAG_OF, FLAGS, finding, names_text, sentence, sentences
from recon.check.inputs import FileFacts, flagged, input_findings
from recon.check.inputs.outliers import without_gross_outliers
from recon.check.inputs.swaps import without_swaps
from recon.check.mismatch import mismatches
from recon.check.rules import findings_of
from recon.check.verdict import judged, usable, verdict_fields, verdict_lines
from recon.fit.finding import Finding, Severity

__all__ = [
    "CODES",
    "FLAGS",
    "FLAG_OF",
    "FileFacts",
    "Finding",
    "Severity",
    "agreement_findings",
    "finding",
    "findings_of",
    "flagged",
    "input_findings",
    "judged",
    "mismatches",
    "names_text",
    "sentence",
    "sentences",
    "usable",
    "verdict_fields",
    "verdict_lines",
    "without_gross_outliers",
    "without_swaps",
]
