#!/bin/sh
# Compare what this tree computes with what another commit did: usage frozen.sh COMMIT [WITHIN] [CASES]. Bit for bit, or
# within a share. The other commit is checked out into build/frozen/tree and run with this environment's packages.
set -eu
commit=$1 within=${2:-0} cases=${3:-100}
python=$PWD/.venv/bin/python
name=$(git rev-parse --short=12 "$commit")
before=build/frozen/$name-$cases.jsonl
if [ ! -s "$before" ]; then
    rm -rf build/frozen/tree
    git worktree prune
    git worktree add --quiet --force --detach build/frozen/tree "$commit"
    there=$PWD/build/frozen/tree
    [ -d "$there/tests/frozen" ] || { echo "$commit does not have tests/frozen yet: it cannot be compared with." >&2; exit 2; }
    echo "Recording $name ..." >&2
    (
        cd "$there"
        PYTHONPATH=$there:$there/core:$there/service:$there/clients/files:$there/clients/python/src \
            "$python" -m tests.frozen.record "$OLDPWD/$before" --cases "$cases"
    )
    git worktree remove --force build/frozen/tree
fi
echo "Recording this tree ..." >&2
"$python" -m tests.frozen.record build/frozen/now.jsonl --cases "$cases"
"$python" -m tests.frozen.compare "$before" build/frozen/now.jsonl --within "$within"
