"""Many perturbed flights of the law on the emulator's physics, in batches: ``covey simulate``."""
