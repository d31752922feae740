# What both scripts for Slurm share: where `signorini` is, and lines of the log with the time. Sourced, not started.
#
# `signorini` is taken from .venv beside the folder from which the job is submitted, else from the modules named in
# SIGNORINI_MODULES ("signorini/0.5", or "dolfinx/0.11 python"), else from PATH.

export OMP_NUM_THREADS=1  # one rank per core is what scales; threads of BLAS would compete with the ranks

if [[ -x "${SLURM_SUBMIT_DIR:-.}/.venv/bin/signorini" ]]; then
    PATH="$(realpath "${SLURM_SUBMIT_DIR:-.}")/.venv/bin:$PATH"
elif [[ -n "${SIGNORINI_MODULES:-}" ]]; then
    # shellcheck disable=SC2086  # several names
    module load $SIGNORINI_MODULES
fi
if ! command -v signorini >/dev/null; then
    echo "no signorini: submit from a folder with .venv, or set SIGNORINI_MODULES to the modules that have it" >&2
    exit 2
fi

timed() {  # the lines of a command with the time before each; its status
    "$@" 2>&1 | (
        trap '' TERM  # which Slurm sends to all of the job: what the run says of it has to reach the log
        while IFS= read -r line; do printf '%(%F %T)T  %s\n' -1 "$line"; done
    )
    return "${PIPESTATUS[0]}"
}

run() {  # signorini on all ranks of the job, then the memory and time that Slurm has counted, where it counts
    local status=0
    trap : TERM  # the run ends by it, and then this
    timed mpirun -n "${SLURM_NTASKS:?start this with sbatch}" signorini "$@" || status=$?
    if [[ -n "${SLURM_JOB_ID:-}" ]] && command -v sstat >/dev/null; then
        sstat --noheader --parsable2 --format=JobID,MaxRSS,AveRSS,NTasks "$SLURM_JOB_ID" 2>/dev/null || true
    fi
    return "$status"
}
