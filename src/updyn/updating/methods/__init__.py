"""The methods: one module each, found through a lazy registry."""
