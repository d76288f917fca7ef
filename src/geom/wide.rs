//! Work compiled a second time for processors with wide registers (AVX2), chosen at run time.
//!
//! The results are the same bits either way, as long as the work uses no operation that only one of them has: Rust
//! never fuses a product with a sum by itself. This is the one file with `unsafe` in it, and it has one line.

#![allow(unsafe_code, reason = "one call, after asking the processor")]

/// What [`run`] does. `work` and all that it calls in its inner loops must be `#[inline(always)]`: what is not inlined
/// stays compiled for narrow registers.
pub trait Work {
    type Out;
    fn work(self) -> Self::Out;
}

/// Does the work, with AVX2 where the processor has it.
#[inline]
pub fn run<W: Work>(work: W) -> W::Out {
    #[cfg(test)]
    if tests::NARROW.with(std::cell::Cell::get) {
        return work.work();
    }
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2, which is all that `wide` asks for.
        return unsafe { wide(work) };
    }
    work.work()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn wide<W: Work>(work: W) -> W::Out {
    work.work()
}

/// `work` on this thread with narrow registers, as on a processor that has no others.
#[cfg(test)]
pub fn narrow<T>(work: impl FnOnce() -> T) -> T {
    tests::NARROW.with(|n| n.set(true));
    let out = work();
    tests::NARROW.with(|n| n.set(false));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    thread_local! {
        pub static NARROW: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
    }

    struct Sum<'a>(&'a [f32]);
    impl Work for Sum<'_> {
        type Out = f32;
        #[inline(always)]
        fn work(self) -> f32 {
            self.0.iter().map(|v| v * 1.1 + 0.3).sum()
        }
    }

    #[test]
    fn the_same_bits() {
        let all: Vec<f32> = (0..999).map(|i| i as f32 / 7.0).collect();
        assert_eq!(run(Sum(&all)).to_bits(), Sum(&all).work().to_bits());
    }
}
