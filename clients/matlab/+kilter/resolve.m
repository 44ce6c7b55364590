function found = resolve(kind, reference, robot)
% RESOLVE  What the beginning of an id, a name or 'latest' stands for; kind is 'campaign', 'version' or 'job'.
%   found = kilter.resolve('version', 'latest', 'arm')
%   FOUND has id, robot, name and by ('id', 'prefix', 'name' or 'latest').
path = ['/v1/resolve?kind=' kilter.internal.quote(kind) '&reference=' kilter.internal.quote(reference)];
if nargin > 2
    path = [path '&robot=' kilter.internal.quote(robot)];
end
found = kilter.internal.fetch(path);
end
