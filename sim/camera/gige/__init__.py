"""The simulated camera as a GigE Vision device on the loopback, for any GigE Vision client."""

from sim.camera.gige.device import GigeDevice

__all__ = ["GigeDevice"]
