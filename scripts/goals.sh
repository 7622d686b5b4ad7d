#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
#
# Every row of the registration table: test splits, all methods, costs. Goes on where it stopped.
# PAIRS (default 1000): pairs of each room split; streets and classical methods take 200 at most.
# DATA (default data/test): the splits. REAL: folder with the recorded pairs, left out when it is not
# there. OUT (default out/goals): scores.
set -euo pipefail
cd "$(dirname "$0")/.."
pairs=${PAIRS:-1000} data=${DATA:-data/test} out=${OUT:-out/goals} real=${REAL:-../shared/data}
few=$((pairs < 200 ? pairs : 200))
mkdir -p "$data" "$out"
for scene in room street; do
  for kind in match lomatch; do
    for share in rigid 10-30 30-50; do
      split=$scene-$kind-$share
      wanted=$([ "$scene" = room ] && echo "$pairs" || echo "$few")
      [ -e "$data/$split" ] && [ -n "${KEEP_DATA:-}" ] \
        || hybridreg generate "$split" --pairs "$wanted" --part test --out "$data/$split"
    done
  done
done
recorded=()
for folder in pairs_3dmatch pairs_7scenes_fragments; do
  [ -d "$real/$folder" ] && recorded+=("$real/$folder")
done
score() {  # METHOD PAIRS FOLDER...
  method=$1 most=$2; shift 2
  hybridreg evaluate "$@" --method "$method" --limit "$most" \
    --keep "$out/$method.jsonl" --json "$out/$method.json"
}
score hybridreg "$pairs" "$data"/*/ ${recorded[@]+"${recorded[@]}"}
for method in no-mask lgr lgr-no-mask; do
  score "$method" "$pairs" "$data/room-match-30-50" "$data/room-lomatch-30-50" ${recorded[@]+"${recorded[@]}"}
done
for method in kiss-matcher fpfh; do
  score "$method" "$few" "$data"/*/ ${recorded[@]+"${recorded[@]}"}
done
clouds=()
if [ -f "$real/pairs_3dmatch/geotransformer_demo.npz" ]; then
  python -c 'import sys, numpy as np
with np.load(sys.argv[1]) as pair:
    for name in ("src", "ref"):
        np.save(f"{sys.argv[2]}/{name}.npy", pair[name])' "$real/pairs_3dmatch/geotransformer_demo.npz" "$out"
  clouds=("$out/src.npy" "$out/ref.npy")
fi
hybridreg bench ${clouds[@]+"${clouds[@]}"} --peers --repeat 15 --json "$out/bench.json"
python scripts/goals_report.py "$out"/{hybridreg,no-mask,lgr,lgr-no-mask,kiss-matcher,fpfh}.json \
  --bench "$out/bench.json"
