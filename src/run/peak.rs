//! The most memory that this process held while something ran: Linux's mark of it (`VmHWM`), set back before. Where that
//! is not allowed the mark still tells if it rose meanwhile; else, and on other systems, nothing is known. The kernel
//! counts pages in batches: a few hundred KiB do not show.

/// From [`start`](Peak::start) to [`end`](Peak::end).
pub struct Peak {
    /// The mark at the start, where it could not be set back.
    before: Option<u64>,
}

impl Peak {
    pub fn start() -> Self {
        let reset = std::fs::write("/proc/self/clear_refs", "5").is_ok();
        Self { before: if reset { None } else { mark() } }
    }

    /// Bytes.
    pub fn end(self) -> Option<u64> {
        let now = mark()?;
        self.before.is_none_or(|before| now > before).then_some(now)
    }
}

fn mark() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}
