"""The window to work in: a local server, and the pages that a browser on the same machine shows."""
