"""Many perturbed flights of the law on the emulator's physics, batched: ``covey simulate``."""
