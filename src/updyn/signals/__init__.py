"""From time records to frequency response functions: records, their quality, estimation."""
