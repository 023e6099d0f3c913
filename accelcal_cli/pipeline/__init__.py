"""Carrying data from layer to layer: the only place where readers, segmenter, collector, optimizer,
judge and writers meet."""
