function document = job(id)
% JOB  A job: state, progress, error, result.
document = kilter.internal.fetch(['/v1/jobs/' kilter.internal.quote(id)]);
end
