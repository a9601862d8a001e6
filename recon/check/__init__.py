"""Every diagnosis of an input or of a fit.

A `Finding` has a code and numbers; `CODES` has its severity and its words. `add_verdict` gives a motion its findings
and the verdict that follows from them. Findings that fit a clip again are `input_findings`; those that compare its
cameras are `agreement_findings`.
"""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.check.agreement import agreement_findings, solve_time_offsets, up_from_feet, why_not_refined
    from recon.check.codes import CODES, FLAG_OF, FLAGS, finding, names_text, sentence, sentences
    from recon.check.inputs import input_findings, with_flags, without_gross_outliers
    from recon.check.rules import findings_of
    from recon.check.swap_repair import downgrade_swap, swap_improves, without_swaps
    from recon.check.verdict import NOTHING_AGAINST, add_verdict, usable, verdict_fields, verdict_lines
    from recon.fit.result import Finding

__getattr__ = lazily(__name__, __file__)
