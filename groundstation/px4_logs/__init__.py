"""PX4's own logs (ULog): read, put on the clock of a flight's record, said in few lines."""
