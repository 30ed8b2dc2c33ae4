"""Files of other programs: third-party libraries read them in a child process, into plain data.

A damaged or hostile file can end the process that reads it, keep it busy for ever, or make it take
all memory. The child process therefore has limits on time and memory. Nothing in its answer is
executed, and callers check the answer like the file itself.
"""
