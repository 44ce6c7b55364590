function job = wait(id)
% WAIT  Wait for the end of a job and return it; a job that failed or was cancelled is an error.
job = kilter.job(id);
while any(strcmp(job.state, {'queued', 'running'}))
    pause(0.3);
    job = kilter.job(id);
end
if strcmp(job.state, 'failed')
    error(['kilter:' job.error.code], '%s', job.error.message);
end
if ~strcmp(job.state, 'succeeded')
    error('kilter:job_cancelled', 'Job %s is %s.', id, job.state);
end
end
