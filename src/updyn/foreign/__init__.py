"""Files of other programs: third-party libraries read them in a child process, into plain data.

A damaged or hostile file can end the process that reads it, keep it busy for ever, or make it take
all memory. `box` starts a child process with limits on time and memory, which runs one `load`
function of the modules here and returns numbers, texts, lists, mappings and arrays, encoded by
`plain`. Nothing in the answer is executed, and callers check it like the file itself. `processes`
starts the child processes.
"""
