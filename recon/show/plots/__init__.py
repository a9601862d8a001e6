"""Figures of a result, for print: one function for each, which returns matplotlib's Figure. `save` writes it."""

from recon.show.plots.configurations import body_fixed, calibration, camera_advice, composites, in_body, observability
from recon.show.plots.over_time import footfall, forces, phase_portraits, speeds, vector_fields
from recon.show.plots.style import COLUMN_MM, WIDTH_MM, save
