#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
#
# Trains for some minutes on a machine with one large GPU and many cores: pairs are generated on
# half of the cores, prepared on a third, and learned from on the GPU.
#
#   scripts/train_gpu.sh MINUTES OUT
#
# MINUTES counts from the start to the last file, validation included. OUT then holds the weights
# (best.safetensors, last.safetensors), log.csv, validation.csv, train.out, config.yaml and state.pt.
# START: weights to start from (default: those of the package; "none": fresh ones).
# VALIDATION: folders of pairs to validate on (default: some are generated first).
# KINDS, SHARES: of the stream. SEED: first scene seed; take one above those used so far.
# LR, UPDATE_PAIRS: learning rate, pairs per optimiser step. DEVICE (default cuda), PRECISION
# (default bf16 on a GPU). PYTHON (default python).
set -euo pipefail
minutes=${1:?usage: scripts/train_gpu.sh MINUTES OUT} out=${2:?usage: scripts/train_gpu.sh MINUTES OUT}
mkdir -p "$out"
out=$(realpath "$out")
[ ! -e "$out/state.pt" ] || { echo "train_gpu: $out holds a run; continue it in a new folder with START=$out/last.safetensors" >&2; exit 2; }
[ "${START:-none}" = none ] || START=$(realpath "$START")
validation=()
for folder in ${VALIDATION:-}; do validation+=("$(realpath "$folder")"); done
cd "$(dirname "$0")/.."
export PYTHONPATH=$PWD${PYTHONPATH:+:$PYTHONPATH}
python=${PYTHON:-python} device=${DEVICE:-cuda} cores=$(nproc)
case $device in cuda*) precision=${PRECISION:-bf16} ;; *) precision=${PRECISION:-float32} ;; esac
start=${START-$(realpath hybridreg_ros/model/weights/*.safetensors)}
[ "$start" != none ] || start=''
generating=$((cores / 2 > 0 ? cores / 2 : 1)) preparing=$((cores / 3 > 0 ? cores / 3 : 1))
hybridreg() { "$python" -m hybridreg_ros.cli.main "$@"; }

if [ ${#validation[@]} -eq 0 ]; then
  for split in room-match-30-50 room-lomatch-30-50 street-match-30-50 street-lomatch-30-50; do
    hybridreg generate "$split" --part val --pairs "${VALIDATION_PAIRS:-12}" --workers "$cores" \
      --out "$out/validation/$split" >> "$out/train.out" 2>&1
    validation+=("$out/validation/$split")
  done
fi

# What is left for steps: the last validation takes about 0.4 s a pair and is given 1 minute more.
left=$(awk -v m="$minutes" -v s="$SECONDS" 'BEGIN { l = m - s / 60 - 1; print (l > 0.5 ? l : 0.5) / 60 }')
list() { local IFS=,; echo "[$*]"; }
cat > "$out/start.yaml" <<YAML
out: $out
start_weights: '$start'
validation: $(list "${validation[@]}")
steps: 100000000
max_hours: $left
seed: ${SEED:-2500000}
lr: ${LR:-0.0002}
final_lr: 0.0
accumulate: ${UPDATE_PAIRS:-2}
device: $device
precision: $precision
workers: $preparing
validate_every: 100000000
validation_pairs: ${VALIDATED:-48}
checkpoint_minutes: 1.0
stream:
  kinds: [${KINDS:-room-train, street-train, street-recorded, room-recorded}]
  shares: [${SHARES:-1.0, 1.0, 1.5, 1.0}]
  first_seed: ${SEED:-2500000}
  workers: $generating
  buffer_mb: 1000.0
budget: {fewest_points: 2000, most_points: 8000}
loss: {descriptor_weight: 1.0, max_anchors: 512, mask_weight: 1.5, false_match_weight: 10.0, masked_correlation: true}
augment: {any_rotation_share: 0.1, yaw_share: 0.7, tilt_share: 0.4, scale_jitter: 0.2, thin_share: 0.2, crop_share: 0.1, hole_share: 0.1}
YAML
hybridreg train -v "$out/start.yaml" 2>&1 | tee -a "$out/train.out"
cp "$out/stream/made.json" "$out/"
rm -rf "$out/stream"
echo "train_gpu: $((SECONDS / 60)) min $((SECONDS % 60)) s; weights and log in $out"
