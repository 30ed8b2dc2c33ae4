#!/bin/sh
# Print the first of the named versions of Python that starts, or python3 if none does.
#
#   tools/find_python.sh 3.12 3.13 3.11
#
# A command on the path may be a shim of pyenv that does not start; pyenv's own folders come next.
for version in "$@"; do
    for found in "python$version" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$version".*/bin/python; do
        if "$found" -c '' >/dev/null 2>&1; then
            command -v "$found"
            exit
        fi
    done
done
command -v python3
