"""Carrying data from room to room: the only place where readers, segmenter, collector, optimizer,
judge and writers meet."""
