#!/usr/bin/env bash
# A parameter study on a cluster: sbatch --ntasks=64 scripts/slurm_study.sh my-study.toml
# Submit it again until it says that all runs are done: finished runs are kept, whatever ended the job. The folder of the
# results must be seen by all nodes.
#SBATCH --job-name=signorini-study
#SBATCH --ntasks=16
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=4G
#SBATCH --time=04:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
set -euo pipefail

# shellcheck source=scripts/slurm_common.sh
source "${SIGNORINI_SCRIPTS:-${SLURM_SUBMIT_DIR:-.}/scripts}/slurm_common.sh"  # Slurm runs a copy of this file, from elsewhere
run study "$@"
