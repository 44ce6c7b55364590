function [url, token] = place()
% PLACE  Where the server is and which token it takes.
%   KILTER_URL and KILTER_TOKEN, else the running server's own files in KILTER_DATA or ~/.kilter.
folder = getenv('KILTER_DATA');
if isempty(folder)
    home = getenv('HOME');
    if isempty(home)
        home = getenv('USERPROFILE');
    end
    folder = fullfile(home, '.kilter');
end
url = getenv('KILTER_URL');
if isempty(url)
    file = fullfile(folder, 'server.json');
    if exist(file, 'file') ~= 2
        error('kilter:server_unreachable', ...
            'No server is known: %s does not exist. Start one with "kilterd serve", or set KILTER_URL.', file);
    end
    known = jsondecode(fileread(file));
    url = known.url;
end
url = regexprep(url, '/+$', '');
token = getenv('KILTER_TOKEN');
% The token file belongs to a server on this machine: it must not travel to another one.
here = ~isempty(regexp(url, '^https?://(127\.|localhost[:/]|localhost$|\[::1\])', 'once'));
file = fullfile(folder, 'token');
if isempty(token) && here && exist(file, 'file') == 2
    token = strtrim(fileread(file));
end
end
