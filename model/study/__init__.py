"""Studies: the trade between speed and accuracy, maps of stability."""
