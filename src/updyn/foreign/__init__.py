"""Files of other programs: third-party libraries read them in a child process, into plain data.

A damaged or hostile file can end the process that reads it, keep it busy for ever, or make it take
all memory. `box` starts a child process with limits on time and memory, which runs one `load`
function of the modules here and sends back what it returns: numbers, texts, lists, mappings and
arrays, as `plain` encodes them. Nothing in the answer is executed, and callers check what they get
as they would check the file itself. `processes` says where that child process comes from.
"""
