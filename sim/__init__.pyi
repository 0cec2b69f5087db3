from .demo_frames import FrameSet as FrameSet
from .demo_frames import make_frames as make_frames
