"""Every diagnosis of an input or of a fit: a `Finding` has a code and numbers, `CODES` its severity and its words.

`judged` gives a motion its findings and the verdict that follows from them. Findings that fit a clip again are
`input_findings`, those that compare its cameras `agreement_findings`."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.check.agreement import agreement_findings, solved_in_step, up_from_feet, why_not_refined
    from recon.check.codes import CODES, FLAG_OF, FLAGS, finding, names_text, sentence, sentences
    from recon.check.inputs import flagged, input_findings, without_gross_outliers
    from recon.check.mended import doubted, mends, without_swaps
    from recon.check.rules import findings_of
    from recon.check.verdict import NOTHING_AGAINST, judged, usable, verdict_fields, verdict_lines
    from recon.fit.result import Finding

__getattr__ = lazily(__name__, __file__)
