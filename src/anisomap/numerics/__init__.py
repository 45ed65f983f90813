"""Arrays in, arrays out: statistics of pairs, metricising, scaling. Knows no skins and no files."""
