"""An ELM327 adapter on TCP, as apps for phones know it, in front of the emulated controller."""
