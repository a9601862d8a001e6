"""Workflows: each file is a readable list of calls."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.workflows.analyse import AnalyseSettings, analyse_command, notes, summarise
    from recon.workflows.batch import COLUMNS, write_summary_page
    from recon.workflows.cli import GROUPS, app, commands, main
    from recon.workflows.clip import prepare
    from recon.workflows.clip_results import OUTPUT_FILES, Record, file_sha256, identity, problem_of, run_clip
    from recon.workflows.convert import ConvertSettings, read_any
    from recon.workflows.look import PageSettings, report
    from recon.workflows.skeleton import check_skeleton, draft_skeleton

__getattr__ = lazily(__name__, __file__)
