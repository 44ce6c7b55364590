function [q, info] = correct(robot, q_deg, varargin)
% CORRECT  Correct a trajectory: rows of joint readings in degrees (prismatic joints: mm).
%   q = kilter.correct('arm', q_deg)
%   [q, info] = kilter.correct('arm', q_deg, 't_s', t, 'payload_kg', 2, 'version', 'ver_7c')
%   [q, info] = kilter.correct('arm', q_deg, 'task', 'pose', 'strict', true)
%   q = kilter.correct('arm', q_deg, 'hold', [1 2])   % joints 1 and 2 stay as they are, such as a rail
%   Q has NaN where a row could not be corrected; INFO.status says why, INFO.error_mm (N, 3) is the tool error removed,
%   INFO.left_mm (N, 1) what is left of it. The status is OK where that is within what is stated, else DAMPED or LIMITED,
%   or UNSURE where the version is less sure than it says.
%   'strict' makes any other status than OK an error.
[given, ~] = kilter.internal.options(varargin);
path = ['/v1/robots/' kilter.internal.quote(robot) '/correct'];
sign = '?';
held = [];
if isfield(given, 'hold')
    held = given.hold;
    given = rmfield(given, 'hold');
end
for joint = reshape(held, 1, [])
    path = [path sign 'hold=' int2str(joint)]; %#ok<AGROW>
    sign = '&';
end
for name = {'version', 'task', 'at_limit', 'strict'}
    if isfield(given, name{1})
        value = given.(name{1});
        if ~ischar(value)
            words = {'false', 'true'};
            value = words{1 + logical(value)};
        end
        path = [path sign name{1} '=' kilter.internal.quote(value)]; %#ok<AGROW>
        sign = '&';
        given = rmfield(given, name{1});
    end
end
described = kilter.robot(robot);
names = cell(1, size(q_deg, 2));
parts = {};
for k = 1:size(q_deg, 2)
    unit = 'deg';
    if k <= numel(described.joints) && strcmp(one(described.joints, k).kind, 'prismatic')
        unit = 'mm';
    end
    names{k} = sprintf('q%d_%s', k, unit);
    parts{end + 1} = column(names{k}, q_deg(:, k)); %#ok<AGROW>
end
extra = fieldnames(given);
for k = 1:numel(extra)
    values = given.(extra{k});
    if isscalar(values)
        values = repmat(values, size(q_deg, 1), 1);
    end
    parts{end + 1} = column(extra{k}, values); %#ok<AGROW>
end
answer = jsondecode(kilter.internal.request('POST', path, ['{' strjoin(parts, ',') '}']));
q = nan(size(q_deg));
for k = 1:numel(names)
    q(:, k) = numbers(answer.(names{k}));
end
info = struct('status', {cellstr(answer.status)}, ...
    'error_mm', [numbers(answer.dx_mm), numbers(answer.dy_mm), numbers(answer.dz_mm)], ...
    'left_mm', numbers(answer.left_mm));
end

function item = one(list, k)
if iscell(list)
    item = list{k};
else
    item = list(k);
end
end

function text = column(name, values)
% Written here, not by jsonencode: one row must stay a list, and every digit counts.
text = ['"' name '":[' strjoin(arrayfun(@(v) sprintf('%.17g', v), values(:)', 'UniformOutput', false), ',') ']'];
end

function out = numbers(values)
% A column with nulls comes as numbers with NaN, or as a cell where all are null.
if iscell(values)
    out = nan(numel(values), 1);
    for k = 1:numel(values)
        if ~isempty(values{k})
            out(k) = values{k};
        end
    end
else
    out = values(:);
end
end
