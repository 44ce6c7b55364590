function job = run(kind, robot, campaigns, options, validation)
% RUN  Queue a job, wait for its end, and return it.
body = struct('kind', kind, 'robot', robot, 'campaigns', {cellstr(campaigns)}, 'options', options);
if ~isempty(validation)
    if iscell(validation) || ischar(validation)
        validation = cellstr(validation);
        body.validation = {};
    end
    body.validation = validation;
end
queued = kilter.internal.send('/v1/jobs', body);
job = kilter.wait(queued.id);
end
