from .objectives import FrameOptions as FrameOptions
from .solution import FrameSolution as FrameSolution
