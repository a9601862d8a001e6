"""The published system: 21 unknowns of the 8U chain, solved frame by frame.

C. van der Leek, "Kinematic Modeling and Dynamic Aspects of an Accelerating Quadruped", MSc(Eng), University of Cape
Town, 2022. chain: the 8U chain and its unknowns; objectives: f1 to f5 and the priors; start: direction of travel and
first pose; solver: Levenberg-Marquardt; solution: its result; inspect and figures: what the optimiser did; report: the
sections of report.json and summary; clip: the commands `recon frame` and `recon solver`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
