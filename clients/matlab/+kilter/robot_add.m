function robot = robot_add(document)
% ROBOT_ADD  Add a robot; the same document again changes nothing.
%   kilter.robot_add('robot.json') sends the file as it is.
%   kilter.robot_add(struct('name', 'arm', 'convention', 'preset', 'preset', 'ur10')) sends a struct.
if ischar(document)
    if exist(document, 'file') ~= 2
        error('kilter:file_invalid', 'There is no file %s.', document);
    end
    robot = jsondecode(kilter.internal.request('POST', '/v1/robots', struct('file', document)));
else
    robot = kilter.internal.send('/v1/robots', document);
end
end
