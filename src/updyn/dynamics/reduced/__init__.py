"""Certified reduced-order models: a large model projected on the few motions that its FRFs consist of."""
