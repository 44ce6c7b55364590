function job = plan(robot, campaigns, varargin)
% PLAN  Plan poses to measure; waits for the end. CAMPAIGNS may be {}.
%   job = kilter.plan('arm', {}, 'purpose', 'iso9283', 'count', 30)
%   Further pairs are the job's options. JOB.result holds the result; a job that fails is an error kilter:CODE.
[options, validation] = kilter.internal.options(varargin);
job = kilter.internal.run('plan', robot, campaigns, options, validation);
end
