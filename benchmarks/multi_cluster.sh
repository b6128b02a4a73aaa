#!/usr/bin/env bash
# P2 on the paper's tier (iid heads, M=5, N=82): the lagged detectors and the trivial policies, 100 episodes each.
# An interrupted run goes on where it stopped.
set -euo pipefail
cd "$(dirname "$0")/.."
usnet=${USNET:-.venv/bin/usnet}
for follow in f1 f2 f3 f4 f5 f6 f7; do
    "$usnet" evaluate --env USNET/MultiCluster-v0 --set follow=$follow --episodes 100 --seed 2022 --trivial \
        --detector 'lagged-regression(clusters=5)' --detector lagged-regression --detector lagged-correlation \
        --out benchmarks/results/multi_cluster/$follow --json > /dev/null
    echo "$follow done"
done
