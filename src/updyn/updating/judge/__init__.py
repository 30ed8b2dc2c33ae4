"""Assessment of a fit: identifiability, adequacy, localisation, rounding, verdict, advice."""
