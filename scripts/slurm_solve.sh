#!/usr/bin/env bash
# One large run on a cluster: sbatch --ntasks=64 scripts/slurm_solve.sh example2 --h 2^-10
# Slurm ends a run at its time limit by SIGTERM: its last state is then in <output>.failed, for --start-from. A run that is
# killed while it solves leaves nothing but, in time, its complete steps, for --restart.
#SBATCH --job-name=signorini
#SBATCH --ntasks=16
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=4G
#SBATCH --time=04:00:00
set -euo pipefail

# shellcheck source=scripts/slurm_common.sh
source "${SIGNORINI_SCRIPTS:-${SLURM_SUBMIT_DIR:-.}/scripts}/slurm_common.sh"  # Slurm runs a copy of this file, from elsewhere
run solve "$@"
