function report = upload(robot, file, varargin)
% UPLOAD  Send a file with contract columns (.csv, .parquet, .json) as a new campaign, or add it to one.
%   report = kilter.upload('arm', 'measured.csv')
%   report = kilter.upload('arm', 'held-out.csv', 'role', 'validation', 'device', 'at960')
%   report = kilter.upload('arm', 'more.csv', 'campaign', report.campaign_id)
%   REPORT has campaign_id, rows and sha256. The same bytes again change nothing.
[given, ~] = kilter.internal.options(varargin);
[~, name, ending] = fileparts(file);
types = struct('csv', 'text/csv', 'parquet', 'application/vnd.apache.parquet', 'json', 'application/json');
kind = lower(strrep(ending, '.', ''));
if exist(file, 'file') ~= 2
    error('kilter:file_invalid', 'There is no file %s.', file);
end
if ~isfield(types, kind)
    error('kilter:file_invalid', '%s: the ending is none of .csv, .parquet, .json. Convert it with "kilter upload".', file);
end
if isfield(given, 'campaign')
    id = given.campaign;
else
    body = struct('name', name, 'role', 'train', 'device', '', 'numbered', ~isfield(given, 'name'));
    names = fieldnames(given);
    for k = 1:numel(names)
        body.(names{k}) = given.(names{k});
    end
    campaign = kilter.internal.send(['/v1/robots/' kilter.internal.quote(robot) '/campaigns'], body);
    id = campaign.id;
end
path = ['/v1/campaigns/' kilter.internal.quote(id) '/observations'];
report = jsondecode(kilter.internal.request('POST', path, struct('file', file), types.(kind)));
report.campaign_id = id;
end
