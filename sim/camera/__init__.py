"""One simulated camera behind two real transports: a GenTL producer and a GigE Vision device.

The device model (registers, SFNC description, trigger and exposure states, faults) knows no transport; a
transport knows no pixels.  Frames come from any `FrameSource`, in this process or another one.
"""
