"""The job file: its schema, and the steps from a job to a folder of results."""

from updyn.job.findings import job_findings
from updyn.job.folder import check_out, default_out
from updyn.job.load import load_job
from updyn.job.prepare import prepare
from updyn.job.prepared import Prepared
from updyn.job.run import JobRun, job_analysis, job_identifiability, job_selection, run_job
from updyn.job.schema import OUTPUTS, Job
from updyn.job.start import start_folder, write_start_pages

__all__ = [
    "OUTPUTS",
    "Job",
    "JobRun",
    "Prepared",
    "check_out",
    "default_out",
    "job_analysis",
    "job_findings",
    "job_identifiability",
    "job_selection",
    "load_job",
    "prepare",
    "run_job",
    "start_folder",
    "write_start_pages",
]
