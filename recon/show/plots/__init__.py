"""Figures of a result, for print: one function for each, which returns matplotlib's Figure. `save` writes it."""

from recon.show.plots.configurations import body_fixed, composites, in_body
from recon.show.plots.observability import calibration, camera_advice, observability
from recon.show.plots.over_time import footfall, forces, speeds
from recon.show.plots.phase import phase_portraits, vector_fields
from recon.show.plots.style import COLUMN_MM, WIDTH_MM, save
