"""Joint fit of a covariogram and of the sensor positions to all correlations."""
