"""The experiments of the paper: one file a figure or group of figures."""
