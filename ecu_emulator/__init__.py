"""The emulated vehicle: plant, sensors and controllers of a wet dual-clutch transmission on a CAN bus.

Its modules load what they need and no more: the command line answers before the plant's compiler is loaded.
"""

__all__ = ["__version__"]

__version__ = "0.1.0"
