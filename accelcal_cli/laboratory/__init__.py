"""The commands of `accelcal evaluate`, which compare methods and repeat the papers' tables."""
