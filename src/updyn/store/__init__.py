"""Records: results of updates, uncertainties and comparisons as netCDF and JSON files."""
