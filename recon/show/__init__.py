"""A result for people and other programs: report, page, figures, tables, overlay, playback."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.show.console import TO_DO
    from recon.show.page.pages import clip_page
    from recon.show.plain import to_plain, write_report
    from recon.show.plots.style import drawing
    from recon.show.report import build_report
    from recon.show.rig import make_rig, rig_of
    from recon.show.tables import write_tables

__getattr__ = lazily(__name__, __file__)
