//! `supertwin pki`: the certificates of a fleet, from its authority to the folder that an operator is handed.

use crate::terminal;
use crate::terminal::table;
use clap::{Args, Subcommand};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use supertwin_operations::OperationError;
use supertwin_pki::PkiError;
use supertwin_pki::{self as pki, Authority, Credentials, Request};
use supertwin_protocol::role::{Role, Scope, common_name};
use supertwin_protocol::{Clock, SystemClock};

/// Hosts at which a vehicle is reached from itself.
const SELF: [&str; 3] = ["localhost", "127.0.0.1", "::1"];

#[derive(Debug, Args)]
#[command(subcommand_required = true, arg_required_else_help = true)]
#[command(after_help = "Examples:
  supertwin pki init --fleet rataren                                         once, on a machine that stays at home
  supertwin pki issue vehicle argus-mini --vehicle argus-mini --host 192.168.2.2
  supertwin pki issue operator anna --vehicle argus-mini                     pki/anna: hand this folder over
  supertwin top --connect tls/192.168.2.2:7447 --credentials pki/anna
  supertwin pki show                                                         who has what, and until when
  supertwin pki renew                                                        all that expire soon

The folder pki/NAME has all that its holder needs: ca.pem, NAME.pem and NAME.key. Copy it to its holder, and nothing
else; after a renewal copy pki/NAME/NAME.pem again: what runs takes it up by itself.")]
pub(crate) struct PkiArguments {
    #[command(subcommand)]
    verb: PkiVerb,

    /// Folder of the authority
    #[arg(long, global = true, value_name = "DIR", env = "SUPERTWIN_PKI", default_value = "pki")]
    dir: PathBuf,

    /// Print JSON
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum PkiVerb {
    /// Make the authority of a fleet
    Init(InitArguments),
    /// Make a key and a certificate for a role and a holder
    Issue(IssueArguments),
    /// Put new certificates in the place of old ones, for the same keys
    Renew(RenewArguments),
    /// Who has which certificate until when, and what is wrong with it
    Show(ShowCertificatesArguments),
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin pki init --fleet rataren
  supertwin pki init --fleet rataren --dir /media/key/pki --days 3650

Whoever has ca.key can be anybody: keep the folder off the vehicles, and keep a copy.
Exit status: 0 done, 2 the call is wrong, or there is an authority already.")]
struct InitArguments {
    /// Name of the fleet
    #[arg(long, value_name = "NAME", default_value = "fleet")]
    fleet: String,

    #[command(flatten)]
    lifetime: Lifetime,
}

#[derive(Debug, Args)]
#[command(after_help = "Roles:
  vehicle    the router and the services on the vehicle; others connect to it, so it names hosts
  guidance   the guidance service topside
  operator   commands
  observer   only looks
  recorder   keeps everything

Examples:
  supertwin pki issue vehicle argus-mini --vehicle argus-mini --host 192.168.2.2 --host argus.local
  supertwin pki issue operator anna --vehicle argus-mini
  supertwin pki issue recorder shore --fleet-wide --days 365

Exit status: 0 done, 2 the call is wrong, or the holder has a folder already.")]
#[command(group = clap::ArgGroup::new("scope").required(true).args(["vehicle", "fleet_wide"]))]
struct IssueArguments {
    /// vehicle, guidance, operator, observer or recorder
    #[arg(value_name = "ROLE")]
    role: Role,

    /// Who holds it: a name of its own in this fleet
    #[arg(value_name = "NAME")]
    holder: String,

    /// The vehicle that it counts for
    #[arg(long, value_name = "NAME")]
    vehicle: Option<String>,

    /// It counts for every vehicle of the fleet
    #[arg(long)]
    fleet_wide: bool,

    /// DNS name or address at which the vehicle is reached; may be repeated [always: localhost, 127.0.0.1, ::1]
    #[arg(long, value_name = "HOST")]
    host: Vec<String>,

    #[command(flatten)]
    lifetime: Lifetime,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin pki renew                            all of this authority that expire soon or have expired
  supertwin pki renew anna --days 60
  supertwin pki renew /tmp/from-the-vehicle.pem  a certificate that was sent here; needs no key of its holder

The key stays as it is, and so do holder, role, vehicle and hosts.
Exit status: 0 done, also when there was nothing to do, 2 the call is wrong or a certificate is not of this authority.")]
struct RenewArguments {
    /// Holders, or certificates [default: all that expire soon]
    #[arg(value_name = "NAME")]
    names: Vec<String>,

    #[command(flatten)]
    lifetime: Lifetime,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin pki show                             the authority and all that it has issued
  supertwin pki show pki/anna /etc/supertwin/argus-mini
  supertwin pki show --within 14 --json          for a timer: exit status 1 when something needs a hand

Exit status: 0 all is well, 1 something expires soon, has expired, or is open to others, 2 the call is wrong.")]
struct ShowCertificatesArguments {
    /// Folders of authorities or holders, or certificates [default: the authority's]
    #[arg(value_name = "PATH")]
    paths: Vec<PathBuf>,

    /// Days that count as soon [default: the last third of a certificate's life, at most 90 days]
    #[arg(long, value_name = "DAYS", default_value = "0", value_parser = clap::value_parser!(u32).range(0..=36_500))]
    within: u32,
}

/// How long a certificate is valid.
#[derive(Clone, Copy, Debug, Args)]
struct Lifetime {
    /// Days that it is valid [default: an authority 1825, others 30, a renewed one as long as before]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=36_500), conflicts_with = "minutes")]
    days: Option<u32>,

    /// … or minutes
    #[arg(long, value_name = "N", value_parser = crate::arguments::positive)]
    minutes: Option<f64>,
}

impl Lifetime {
    fn get(self) -> Option<Duration> {
        let days = self.days.map(|days| pki::DAY * days);
        // More than a century is refused further down.
        days.or_else(|| self.minutes.map(|minutes| Duration::from_secs_f64((60.0 * minutes).min(1e10))))
    }
}

pub(crate) fn pki(arguments: &PkiArguments) -> Result<ExitCode, OperationError> {
    let clock = SystemClock::start();
    match &arguments.verb {
        PkiVerb::Init(init) => arguments.init(init, &clock),
        PkiVerb::Issue(issue) => arguments.issue(issue, &clock),
        PkiVerb::Renew(renew) => arguments.renew(renew, &clock),
        PkiVerb::Show(show) => arguments.show(show, &clock),
    }
}

impl PkiArguments {
    fn init(&self, arguments: &InitArguments, clock: &dyn Clock) -> Result<ExitCode, OperationError> {
        let lifetime = arguments.lifetime.get().unwrap_or(pki::AUTHORITY_LIFETIME);
        let authority = Authority::init(&self.dir, &arguments.fleet, lifetime, clock)?;
        let until = authority.certificate.not_after();
        terminal::print_result(
            self.json,
            &json!({ "authority": self.dir, "certificate": authority.certificate }),
            || {
                format!(
                    "{}: the authority of {}, valid until {until}. Keep ca.key here, and keep a copy.",
                    self.dir.display(),
                    arguments.fleet
                )
            },
        );
        Ok(ExitCode::SUCCESS)
    }

    fn issue(&self, arguments: &IssueArguments, clock: &dyn Clock) -> Result<ExitCode, OperationError> {
        let authority = Authority::open(&self.dir)?;
        let scope = Scope::of(arguments.vehicle.as_deref()).map_err(OperationError::Option)?;
        let mut request = Request::new(arguments.role, scope, &arguments.holder);
        request.lifetime = arguments.lifetime.get().unwrap_or(request.lifetime);
        request.hosts.clone_from(&arguments.host);
        if arguments.role.listens() {
            let missing = SELF.iter().filter(|host| !arguments.host.iter().any(|other| other == *host));
            request.hosts.extend(missing.map(|&host| host.to_owned()));
        }
        let made = authority.issue(&request, clock)?;
        let certificate = pki::read(&made.certificate)?;
        let folder = made.certificate.parent().unwrap_or(Path::new("")).display().to_string();
        let name = common_name(request.role, &request.scope);
        let result = json!({ "ca": made.ca, "certificate": made.certificate, "key": made.key, "says": certificate });
        terminal::print_result(self.json, &result, || {
            format!("{folder}: {} is {name} until {}", request.holder, certificate.not_after())
        });
        Ok(ExitCode::SUCCESS)
    }

    fn renew(&self, arguments: &RenewArguments, clock: &dyn Clock) -> Result<ExitCode, OperationError> {
        let authority = Authority::open(&self.dir)?;
        let paths: Vec<PathBuf> = if arguments.names.is_empty() {
            let all = pki::examine(&self.dir, 0, clock)?.into_iter();
            let due = all.filter(|one| !one.certificate.is_authority && one.standing != pki::Standing::Valid);
            due.map(|one| one.path).collect()
        } else {
            let holder = |name: &String| {
                let folder = self.dir.join(name);
                let place = if folder.is_dir() { folder } else { PathBuf::from(name) };
                if place.is_dir() { Ok(Credentials::find(&place)?.certificate) } else { Ok(place) }
            };
            arguments.names.iter().map(holder).collect::<Result<_, PkiError>>()?
        };
        let mut renewed = Vec::new();
        for path in &paths {
            let certificate = authority.renew(path, arguments.lifetime.get(), clock)?;
            if !self.json {
                terminal::print(&format!(
                    "{}: {} until {}",
                    path.display(),
                    certificate.common_name,
                    certificate.not_after()
                ));
            }
            renewed.push(json!({ "path": path, "certificate": certificate }));
        }
        if self.json {
            terminal::print(&json!({ "renewed": renewed }).to_string());
        } else if renewed.is_empty() {
            terminal::print("nothing to renew: no certificate expires soon");
        }
        Ok(ExitCode::SUCCESS)
    }

    fn show(&self, arguments: &ShowCertificatesArguments, clock: &dyn Clock) -> Result<ExitCode, OperationError> {
        let own = [self.dir.clone()];
        let paths = if arguments.paths.is_empty() { &own[..] } else { &arguments.paths };
        let within_s = i64::from(arguments.within) * 24 * 3600;
        let mut all = Vec::new();
        for path in paths {
            all.extend(pki::examine(path, within_s, clock)?);
        }
        let well = all.iter().all(|one| one.problems.is_empty());
        terminal::print_result(self.json, &json!({ "certificates": all, "well": well }), || listed(&all));
        Ok(if well { ExitCode::SUCCESS } else { ExitCode::from(1) })
    }
}

fn listed(all: &[pki::Examined]) -> String {
    let rows = all.iter().map(|one| {
        let certificate = &one.certificate;
        let name = if certificate.is_authority { "authority" } else { &certificate.common_name };
        let holder = certificate.holder.as_deref().or(certificate.fleet.as_deref()).unwrap_or_default();
        let days_left = format!("{:.1}", one.days_left);
        let cells = [holder, name, &certificate.hosts.join(" "), &certificate.not_after(), &days_left];
        cells.map(str::to_owned).to_vec()
    });
    let mut text = table(&["holder", "name", "hosts", "valid until", "days left"], rows.collect(), 4);
    for (one, problem) in all.iter().flat_map(|one| one.problems.iter().map(move |problem| (one, problem))) {
        text += &format!("\nwarning: {}: {problem}", one.path.display());
    }
    text
}
