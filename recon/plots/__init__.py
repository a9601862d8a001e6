"""Figures of a result, for print: one function for each, which returns matplotlib's Figure. `save` writes it."""

from recon.plots.advice import camera_advice
from recon.plots.climb import climb_field, climb_footfalls, climb_margins
from recon.plots.closure import closures
from recon.plots.composite import composites
from recon.plots.configurations import body_fixed, in_body, limbs_apart
from recon.plots.field import vector_fields
from recon.plots.footfall import footfall
from recon.plots.observability import observability
from recon.plots.parameters import parameter_series
from recon.plots.phase import phase_portraits
from recon.plots.reach import distances, joint_space, task_space
from recon.plots.solver import image_errors, solver_root, solver_search, solver_unknowns
from recon.plots.speed import speeds
from recon.plots.style import COLUMN_MM, WIDTH_MM, save

__all__ = [
    "COLUMN_MM",
    "WIDTH_MM",
    "body_fixed",
    "camera_advice",
    "climb_field",
    "climb_footfalls",
    "climb_margins",
    "closures",
    "composites",
    "distances",
    "footfall",
    "image_errors",
    "in_body",
    "joint_space",
    "limbs_apart",
    "observability",
    "parameter_series",
    "phase_portraits",
    "save",
    "solver_root",
    "solver_search",
    "solver_unknowns",
    "speeds",
    "task_space",
    "vector_fields",
]
