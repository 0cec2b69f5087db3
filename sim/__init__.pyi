from .demo.frames import FrameSet as FrameSet
from .demo.frames import make_frames as make_frames
from .flow.fields import Flow as Flow
from .flow.images import FlowCamera as FlowCamera
from .flow.images import render_pairs as render_pairs
from .flow.jet import Jet as Jet
from .flow.modes import RandomModes as RandomModes
