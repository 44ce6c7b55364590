#!/bin/sh
# Measure the kernels of this tree beside those of another commit, in turns: usage bench_beside.sh [COMMIT] [ROUNDS].
# The other commit is checked out into build/beside/tree and measured by this tree's benchmark.
set -eu
commit=${1:-HEAD~1} rounds=${2:-5}
python=$PWD/.venv/bin/python here=$PWD there=$PWD/build/beside/tree
mkdir -p build/beside
rm -rf "$there"
git worktree prune
git worktree add --quiet --force --detach "$there" "$commit"
trap 'git worktree remove --force "$there"' EXIT
cp benchmarks/kernels.py "$there/benchmarks/kernels.py"
: > build/beside/before.jsonl
: > build/beside/now.jsonl

measure() {
    (cd "$1" && PYTHONPATH=$1:$1/core:$1/service:$1/clients/files:$1/clients/python/src "$python" -m benchmarks.kernels)
}

echo "Compiling ..." >&2
measure "$there" > /dev/null
measure "$here" > /dev/null
for round in $(seq "$rounds"); do
    echo "Round $round of $rounds" >&2
    measure "$there" >> build/beside/before.jsonl
    measure "$here" >> build/beside/now.jsonl
done
"$python" -m benchmarks.beside build/beside/before.jsonl build/beside/now.jsonl
