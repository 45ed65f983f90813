"""Fit of one covariogram and of the sensor positions to all correlations."""
