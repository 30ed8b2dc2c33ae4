"""Writing of results: updyn replaces only its own files, and a set of files at once.

``manifest.json`` in a folder lists each file that updyn wrote there, with the id of its run and its
SHA-256 digest. A file that is not listed, or that has changed since, belongs to a user and is
neither replaced nor removed (`updyn.outputs.manifest`). A lock excludes a second process
(`updyn.outputs.lock`). New files are written next to the old ones and replace them together; the
next process completes an interrupted switch (`updyn.outputs.switch`).
"""
