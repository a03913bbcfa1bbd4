"""PX4's own logs (ULog): reads them, aligns them with a flight's record and summarises them."""
