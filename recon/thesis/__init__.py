"""Implement the published system, which solves the 21 unknowns of the 8U chain frame by frame.

The publication is C. van der Leek, "Kinematic Modeling and Dynamic Aspects of an Accelerating Quadruped", MSc(Eng),
University of Cape Town, 2022. The modules are:

- `chain`: the 8U chain and its unknowns
- `objectives`: f1 to f5 and the priors
- `start`: the direction of travel and the first pose
- `solver`: the frame-by-frame solution with MINPACK's Levenberg-Marquardt
- `levenberg`: Levenberg-Marquardt with a given initial damping
- `path`: the smooth path that constrains the second solution of all frames
- `solution`: the result
- `inspect` and `figures`: tables and figures of the optimisation
- `report`: sections of report.json and of the summary
- `clip`: functions behind the commands `recon frame` and `recon solver`
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
