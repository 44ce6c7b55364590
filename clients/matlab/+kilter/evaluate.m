function job = evaluate(robot, campaigns, varargin)
% EVALUATE  Compare a version with a campaign; waits for the end.
%   job = kilter.evaluate('arm', campaign, 'version', 'ver_7c')
%   Further pairs are the job's options. JOB.result holds the result; a job that fails is an error kilter:CODE.
%     version              Id of the version; left out: the active one, else the nominal robot.
%     refit                Frames refitted to these rows: [], ["base"] or ["base", "tool"] (the tracker was set up
%                          again).
%     metrics              Errors, or the criteria of ISO 9283.
%     criteria             Criteria of ISO 9283 that must be given; left out: all that the rows support.
[options, validation] = kilter.internal.options(varargin);
job = kilter.internal.run('evaluate', robot, campaigns, options, validation);
end
