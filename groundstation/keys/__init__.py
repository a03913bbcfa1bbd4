"""The keys of a fleet: its certificate authority, the certificates of its nodes, signing keys."""
