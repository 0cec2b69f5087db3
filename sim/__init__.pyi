from .demo.frames import FrameSet as FrameSet
from .demo.frames import make_frames as make_frames
