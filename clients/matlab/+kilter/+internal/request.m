function text = request(method, path, body, content_type)
% REQUEST  Send one request with the system's curl and return the answer's text.
%   Errors of the server come as kilter:CODE with the server's sentence.
%   BODY is text, or a struct('file', NAME) whose bytes are sent as they are.
if nargin < 3
    body = '';
end
if nargin < 4
    content_type = 'application/json';
end
[url, token] = kilter.internal.place();
work = tempname();
[made, message] = mkdir(work);
if ~made
    error('kilter:file_invalid', 'The temporary folder %s cannot be made: %s', work, message);
end
cleaner = onCleanup(@() remove(work));
answer = fullfile(work, 'answer');
lines = {'silent', 'show-error', ['request = ' quoted(method)], ['url = ' quoted([url path])], ...
    ['output = ' quoted(answer)], ['write-out = ' quoted('%{http_code}')], 'max-time = 900'};
% The token stands in a file of this user, not on a command line that everybody can list.
if ~isempty(token)
    lines{end + 1} = ['header = ' quoted(['Authorization: Bearer ' token])];
end
if isstruct(body)
    source = body.file;
else
    source = fullfile(work, 'body');
    write(source, body);
end
if ~strcmp(method, 'GET')
    lines{end + 1} = ['header = ' quoted(['Content-Type: ' content_type])];
    lines{end + 1} = ['data-binary = ' quoted(['@' source])];
end
settings = fullfile(work, 'curl.conf');
write(settings, strjoin(lines, sprintf('\n')));
[code, printed] = system(sprintf('curl --config "%s" 2>&1', settings));
text = '';
if exist(answer, 'file') == 2
    text = fileread(answer);
end
status = str2double(regexprep(printed, '^.*?(\d{3})\s*$', '$1'));
if code ~= 0
    error('kilter:server_unreachable', '%s does not answer (%s). Is the server running, and KILTER_URL right?', ...
        url, strtrim(regexprep(printed, '\d{3}\s*$', '')));
end
if status >= 400
    refuse(text, status);
end
end

function refuse(text, status)
code = 'api_error';
detail = sprintf('The server answered %d.', status);
try
    problem = jsondecode(text);
    code = problem.code;
    detail = problem.detail;
catch
    % An answer that is not a problem document comes from something else than Kilter; its status is all there is to say.
end
error(['kilter:' code], '%s', detail);
end

function out = quoted(text)
out = ['"' strrep(strrep(text, '\', '\\'), '"', '\"') '"'];
end

function write(file, text)
handle = fopen(file, 'w');
if handle < 0
    error('kilter:file_invalid', '%s cannot be written.', file);
end
fwrite(handle, unicode2native(text, 'UTF-8'), 'uint8');
fclose(handle);
end

function remove(folder)
names = {'answer', 'body', 'curl.conf'};
for k = 1:numel(names)
    if exist(fullfile(folder, names{k}), 'file') == 2
        delete(fullfile(folder, names{k}));
    end
end
rmdir(folder);
end
