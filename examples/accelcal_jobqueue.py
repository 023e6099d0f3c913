"""Runs a study on up to 20 Slurm jobs, as needed: `python accelcal_jobqueue.py FOLDER OUT [OPTION...]`.

Needs `pip install distributed dask-jobqueue`. Runs until the study is done, on a login node or in a job.
"""

import subprocess
import sys

from dask_jobqueue import SLURMCluster

WORKERS = 20

with SLURMCluster(cores=1, processes=1, memory="1GB", walltime="08:00:00") as cluster:
    cluster.adapt(minimum=1, maximum=WORKERS)
    words = [*sys.argv[1:], "--dask", cluster.scheduler_address]
    sys.exit(subprocess.call([sys.executable, "-m", "accelcal_cli", "study", words[0], "-d", *words[1:]]))
