//! A Slurm of our own: munged, slurmctld and two slurmd on this machine, with directories, ports and
//! processes of their own.

use std::fs;
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;
use testkit::{ended, within};

/// How long to wait for a daemon.
const DAEMON: Duration = Duration::from_secs(40);

/// The cluster. Dropping it ends every process that it started.
pub struct Cluster {
    place: TempDir,
    /// Directory of programs, first in the PATH of jobs.
    programs: PathBuf,
    /// Daemons by their names.
    daemons: Vec<(&'static str, Child)>,
}

impl Cluster {
    /// Starts a cluster of the nodes n1 and n2 with one processor each.
    pub fn start(programs: &Path) -> Self {
        let mut cluster = Self {
            place: TempDir::new().unwrap(),
            programs: programs.to_owned(),
            daemons: Vec::new(),
        };
        for directory in ["state", "work", "munge"] {
            fs::create_dir(cluster.path(directory)).unwrap();
        }
        let key = cluster.path("munge/key");
        fs::write(&key, [7; 64]).unwrap();
        fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).unwrap();
        fs::write(cluster.configuration(), cluster.text()).unwrap();
        let mut munged = testkit::command("munged");
        munged.args(["--foreground", "--force", "--num-threads=2"]);
        for file in ["socket", "key", "pid", "log", "seed"] {
            let path = cluster.path("munge").join(file);
            let flag = if file == "socket" {
                "socket".to_owned()
            } else {
                format!("{file}-file")
            };
            munged.arg(format!("--{flag}={}", path.display()));
        }
        cluster.daemon("munged", munged);
        let socket = cluster.path("munge/socket");
        within(DAEMON, || socket.exists().then_some(())).expect("munged gives no socket");
        let mut controller = testkit::command("slurmctld");
        controller.arg("-D").arg("-f").arg(cluster.configuration());
        cluster.daemon("slurmctld", controller);
        cluster.start_node("n1");
        cluster.start_node("n2");
        cluster
    }

    /// The configuration: a node that is silent for 6 s is down, and its jobs are requeued.
    fn text(&self) -> String {
        let listeners = [0; 3].map(|_| TcpListener::bind("127.0.0.1:0").unwrap());
        let ports = listeners.map(|listener| listener.local_addr().unwrap().port());
        let host = rustix::system::uname();
        let host = host.nodename().to_string_lossy().into_owned();
        let here = self.place.path().display();
        format!(
            "ClusterName=vpc\nSlurmctldHost={host}(127.0.0.1)\nSlurmctldPort={}\nSlurmUser=root\n\
             AuthType=auth/munge\nAuthInfo=socket={here}/munge/socket,cred_expire=5\n\
             StateSaveLocation={here}/state\nSlurmdSpoolDir={here}/%n\n\
             SlurmctldPidFile={here}/slurmctld.pid\nSlurmdPidFile={here}/%n.pid\n\
             ProctrackType=proctrack/linuxproc\nTaskPlugin=task/none\nMpiDefault=none\n\
             SelectType=select/cons_tres\nSelectTypeParameters=CR_CPU\n\
             ReturnToService=2\nSlurmdTimeout=6\nJobRequeue=1\nSchedulerParameters=sched_interval=2\n\
             NodeName=n1 NodeHostname={host} NodeAddr=127.0.0.1 Port={} CPUs=1\n\
             NodeName=n2 NodeHostname={host} NodeAddr=127.0.0.1 Port={} CPUs=1\n\
             PartitionName=all Nodes=ALL Default=YES State=UP\n",
            ports[0], ports[1], ports[2]
        )
    }

    fn path(&self, name: &str) -> PathBuf {
        self.place.path().join(name)
    }

    fn configuration(&self) -> PathBuf {
        self.path("slurm.conf")
    }

    /// The directory in which jobs are submitted.
    pub fn work(&self) -> PathBuf {
        self.path("work")
    }

    fn daemon(&mut self, name: &'static str, mut command: Command) {
        let log = fs::File::create(self.path(name).with_extension("log")).unwrap();
        let search = format!(
            "{}:/usr/sbin:/sbin",
            std::env::var("PATH").unwrap_or_default()
        );
        command
            .env("PATH", search)
            .env("SLURM_CONF", self.configuration());
        command
            .stdin(Stdio::null())
            .stdout(log.try_clone().unwrap())
            .stderr(log);
        let child = command
            .spawn()
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        self.daemons.push((name, child));
    }

    /// Starts the daemon of a node, and waits until jobs can run on it.
    pub fn start_node(&mut self, name: &'static str) {
        let mut daemon = testkit::command("slurmd");
        daemon
            .args(["-D", "-N", name, "-f"])
            .arg(self.configuration());
        self.daemon(name, daemon);
        let is_up = || {
            let state = self.ask("sinfo", &["-h", "-n", name, "-o", "%T"]);
            ["idle", "mixed", "allocated"]
                .contains(&state.trim())
                .then_some(())
        };
        within(DAEMON, is_up).unwrap_or_else(|| panic!("{name} does not come up: {}", self.logs()));
    }

    /// Kills the daemon of a node with SIGKILL, and all that runs there.
    pub fn kill_node(&mut self, name: &str) {
        let at = self.daemons.iter().position(|(daemon, _)| *daemon == name);
        let (_, mut child) = self.daemons.remove(at.unwrap());
        child.kill().unwrap();
        child.wait().unwrap();
        let killed = self.kill_jobs(Some(name));
        assert!(
            killed > 1,
            "{killed} processes were on {name}; expected: a step and its job"
        );
    }

    /// Kills the jobs' processes, on one node or on all, and the steps that hold them.
    fn kill_jobs(&self, node: Option<&str>) -> usize {
        let mark = format!("SLURM_SUBMIT_DIR={}", self.work().display());
        let node = node.map(|name| format!("SLURMD_NODENAME={name}"));
        let mut found = Vec::new();
        for entry in fs::read_dir("/proc").unwrap().flatten() {
            let Ok(pid) = entry.file_name().to_string_lossy().parse::<i32>() else {
                continue;
            };
            let environment = fs::read(entry.path().join("environ")).unwrap_or_default();
            let has = |words: &str| {
                environment
                    .split(|byte| *byte == 0)
                    .any(|v| v == words.as_bytes())
            };
            if has(&mark) && node.as_deref().is_none_or(has) {
                found.push(pid);
                found.extend(step(pid));
            }
        }
        found.sort_unstable();
        found.dedup();
        for pid in found.iter().filter_map(|pid| Pid::from_raw(*pid)) {
            let _ = kill_process(pid, Signal::KILL);
        }
        found.len()
    }

    /// Runs a command of Slurm; what it prints.
    pub fn ask(&self, program: &str, words: &[&str]) -> String {
        let mut command = testkit::command(program);
        let search = std::env::var("PATH").unwrap_or_default();
        command.args(words).current_dir(self.work());
        command.env("SLURM_CONF", self.configuration());
        command.env("PATH", format!("{}:{search}", self.programs.display()));
        ended(command).stdout
    }

    /// Submits a script; the job's number.
    pub fn submit(&self, words: &[&str]) -> String {
        let job = self.ask("sbatch", &[&["--parsable"], words].concat());
        let job = job.trim().to_owned();
        assert!(
            job.parse::<u32>().is_ok(),
            "sbatch {words:?}: {job}; {}",
            self.logs()
        );
        job
    }

    /// The fields of a job, or of each task of an array, as `scontrol` prints them.
    pub fn job(&self, job: &str) -> Vec<String> {
        let text = self.ask("scontrol", &["-o", "show", "job", job]);
        text.lines().map(str::to_owned).collect()
    }

    /// Waits until a job, or every task of an array, is completed.
    pub fn completed(&self, job: &str, patience: Duration) {
        let begin = Instant::now();
        loop {
            let tasks = self.job(job);
            let all = |state: &str| tasks.iter().all(|task| field(task, "JobState") == state);
            if !tasks.is_empty() && all("COMPLETED") {
                return;
            }
            let ends = ["FAILED", "CANCELLED", "TIMEOUT", "OUT_OF_MEMORY"];
            let failed = tasks
                .iter()
                .find(|task| ends.contains(&field(task, "JobState")));
            let is_over = begin.elapsed() > patience;
            assert!(
                failed.is_none() && !is_over,
                "{job}: {tasks:#?}\n{}",
                self.logs()
            );
            std::thread::sleep(Duration::from_millis(200));
        }
    }

    /// Ends of the logs of daemons and jobs.
    pub fn logs(&self) -> String {
        let mut text = String::new();
        for directory in [self.place.path().to_owned(), self.work()] {
            for entry in fs::read_dir(directory).unwrap().flatten() {
                let path = entry.path();
                if path.extension().is_some_and(|end| end == "log") {
                    let log = fs::read_to_string(&path).unwrap_or_default();
                    let lines: Vec<_> = log.lines().collect();
                    let last = &lines[lines.len().saturating_sub(15)..];
                    text += &format!("-- {}\n{}\n", path.display(), last.join("\n"));
                }
            }
        }
        text
    }
}

/// A field of what `scontrol -o` prints.
pub fn field<'a>(job: &'a str, key: &str) -> &'a str {
    let mut pairs = job
        .split_whitespace()
        .filter_map(|word| word.split_once('='));
    pairs
        .find(|(name, _)| *name == key)
        .map_or("", |(_, value)| value)
}

/// The slurmstepd above a process.
fn step(mut pid: i32) -> Option<i32> {
    for _ in 0..8 {
        let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
        let (name, rest) = stat.rsplit_once(") ")?;
        if name.contains("(slurmstepd") {
            return Some(pid);
        }
        pid = rest.split_whitespace().nth(1)?.parse().ok()?;
    }
    None
}

impl Drop for Cluster {
    fn drop(&mut self) {
        // Nodes first, so that nothing is started again.
        for (_, mut daemon) in self.daemons.drain(..).rev() {
            let _ = daemon.kill();
            let _ = daemon.wait();
        }
        self.kill_jobs(None);
    }
}
