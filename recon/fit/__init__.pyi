from .clip_problem import TrajectoryOptions as TrajectoryOptions
from .result import Solution as Solution
from .result import TrajectorySolution as TrajectorySolution
