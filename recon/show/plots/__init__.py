"""Figures of a result, for print: one function for each, which returns matplotlib's Figure. `save` writes it."""

from recon.show.plots.configurations import body_fixed, composites, in_body, limbs_apart
from recon.show.plots.field import vector_fields
from recon.show.plots.footfall import footfall, forces
from recon.show.plots.observability import camera_advice, observability
from recon.show.plots.phase import phase_portraits
from recon.show.plots.speed import speeds
from recon.show.plots.style import COLUMN_MM, WIDTH_MM, save
