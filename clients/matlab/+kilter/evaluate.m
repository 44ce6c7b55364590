function job = evaluate(robot, campaigns, varargin)
% EVALUATE  Compare a version with a campaign; waits for the end.
%   job = kilter.evaluate('arm', campaign, 'version', 'ver_7c')
%   Further pairs are the job's options. JOB.result holds the result; a job that fails is an error kilter:CODE.
[options, validation] = kilter.internal.options(varargin);
job = kilter.internal.run('evaluate', robot, campaigns, options, validation);
end
