function job = gap(robot, campaigns, varargin)
% GAP  Find and name what the model is missing; waits for the end.
%   job = kilter.gap('arm', {train, more}, 'alpha', 0.01)
%   Further pairs are the job's options. JOB.result holds the result; a job that fails is an error kilter:CODE.
[options, validation] = kilter.internal.options(varargin);
job = kilter.internal.run('gap', robot, campaigns, options, validation);
end
