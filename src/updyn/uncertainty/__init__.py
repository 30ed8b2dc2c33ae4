"""How far an estimate can be believed: profile likelihood, bootstrap, sampling, and bands of prediction."""
