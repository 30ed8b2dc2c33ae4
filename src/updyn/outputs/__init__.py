"""What updyn writes into a folder: it replaces only its own files, and a set of them as one.

``manifest.json`` in the folder lists each file that updyn wrote there, with the id of its run and
its SHA-256 digest. A file that is not listed, or that has been changed since, is a user's: it is
neither replaced nor removed (`updyn.outputs.manifest`). A lock keeps a second process out
(`updyn.outputs.lock`). New files are written beside the old ones and take their places together; an
interrupted switch is completed by the next process (`updyn.outputs.switch`).
"""
