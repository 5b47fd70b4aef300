function samples = fly(base, rig, token)
% FLY  Lift the ball, record 2 s of it, plot them, switch the coil off.
%   fly                                             rig1 at the control room of this machine
%   fly('https://10.0.0.5:8051', 'rig1', 'b51_...') at one with logins
% For MATLAB (R2016b or newer) and GNU Octave (7 or newer).  The fields of samples are columns in SI units.
  if nargin < 1, base = 'http://127.0.0.1:8051'; end
  if nargin < 2, rig = 'rig1'; end
  if nargin < 3, token = ''; end
  url = [base '/api/v1/rigs/' rig];
  stop = onCleanup(@() ask([url '/stop?soft_errors=true'], token, 'by', 'fly'));  % whatever happens from here on
  command(url, token, 'command', 'mode', 'mode', 'closed-loop');
  command(url, token, 'command', 'reference', 'x_ref_m', '0.0030');
  pause(1);
  command(url, token, 'command', 'reference', 'x_ref_m', '0.0035');
  pause(1.5);
  samples = ask([url '/states?last_s=2'], token);
  if nargout > 0, return, end
  plot(samples.t_s, 1e3 * [samples.x_m samples.x_ref_m]);
  xlabel('t, s'); ylabel('x, mm'); legend('ball', 'reference');
end

function command(url, token, varargin)
% Send a command; a refusal is an error with its reason and remedy.  With soft_errors the status is 200 also then.
  reply = ask([url '/commands?soft_errors=true'], token, varargin{:});
  if ~reply.executed
    error(['board51:' strrep(reply.code, '-', '_')], '%s %s', reply.message, reply.remedy);
  end
end

function answer = ask(url, token, varargin)
% GET, or POST a form of names and values.  MATLAB decodes JSON by itself, Octave does not.
  options = weboptions();  % new each time: Octave's webwrite changes it
  options.Timeout = 15;
  if ~isempty(token), options.HeaderFields = {'Authorization', ['Bearer ' token]}; end
  if isempty(varargin), answer = webread(url, options); else, answer = webwrite(url, varargin{:}, options); end
  if ischar(answer), answer = jsondecode(answer); end
end
